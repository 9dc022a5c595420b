MODULE weldline
CONST robtarget pW10:=[[ 905.120, -12.000, 410.330 ],[ 0.0067, 0.9236, -0.3833, 0.0010 ],[ 0, -1, 0, 1 ],[ 9E9, 9E9, 9E9, 9E9, 9E9, 9E9 ]];
CONST robtarget pW20:=[[905.12,55.0,410.33],[0.0067,0.9236,-0.3833,0.0010],[0,-1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget pSearch:=[[905.12,80.0,410.33],[0.0067,0.9236,-0.3833,0.0010],[0,-1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
VAR robtarget pFound:=[[0,0,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget pBad:=[[0,0,0],[0,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PERS tooldata tHeld:=[FALSE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PROC main()
  ArcLStart pW10,v1000,sm1,wd1,fine,tTorch\WObj:=wFix;
  ArcLEnd pW20,v1000,sm1,wd1,fine,tTorch\WObj:=wFix;
  SearchL \Stop,diSense,pFound,pSearch,v50,tTorch\WObj:=wFix;
  MoveL pFound,v50,fine,tTorch\WObj:=wFix;
  PDispOn \ExeP:=pW10,pW20,tTorch;
  MoveL pW10,v50,fine,tHeld;
  TPWrite "MoveL pW20,v5,fine,tool0; !";
ENDPROC
ENDMODULE
